"""Threads that share work, and memory that is used again."""
