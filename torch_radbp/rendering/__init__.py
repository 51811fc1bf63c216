"""What serves every rendering: the renderer, its settings, the call and what is planned for it."""
