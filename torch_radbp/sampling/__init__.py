"""Random numbers addressed by (seed, lane, depth, dimension), and the mappings that use them."""
