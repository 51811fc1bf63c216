"""What users render with: the renderer, its settings, and what is planned for a call."""
