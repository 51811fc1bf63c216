"""File formats of images, meshes and volumes, read and written; what they stand for in a scene is the business of io/."""
