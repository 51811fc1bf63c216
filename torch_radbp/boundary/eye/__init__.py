"""Who sees a curve: cameras, lights, vertices of paths, and cameras by way of mirrors and glass."""
