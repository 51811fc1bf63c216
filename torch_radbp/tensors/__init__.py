"""Records of tensors, vectors, table look-ups by lane, and what of them is differentiated."""
