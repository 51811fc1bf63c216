"""Path tracing's recursion: states, one bounce, queues, one step of all paths (wavefront), the sum over bounces (trace)."""
