"""The recursion: what a path knows (state), one bounce of it (bounce), its queues, one step of all paths (wavefront), and
what all steps bring (trace). Compiled steps are machine code from end to end (taped_bounces)."""
