"""The recursion: what a path knows (state), one bounce of it (bounce), its queues, and the loop over bounces (wavefront)."""
