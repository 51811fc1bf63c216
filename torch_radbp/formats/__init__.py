"""Readers and writers of files of images, meshes and volumes; io/ turns their contents into scenes."""
