"""What one rendering keeps of a scene for the next, so that only what has changed is made anew."""
