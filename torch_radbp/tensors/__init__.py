"""Tensors as all parts use them: records of them, vectors, reads of tables by lane, and what of them is differentiated."""
