"""One call of a renderer: its views, the chunks of its lanes, and the threads that trace them."""
