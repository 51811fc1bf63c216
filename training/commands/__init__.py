"""The commands of `radbp`, a file each, and what they share."""
