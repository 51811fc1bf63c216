"""The processor as a target: programs and recordings as machine code that runs on several threads."""
