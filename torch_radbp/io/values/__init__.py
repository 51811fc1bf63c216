"""The values in descriptions of scenes: read, checked and converted."""
