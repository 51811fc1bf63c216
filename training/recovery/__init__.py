"""The recovery of parameters: what is optimised, by which loss and steps, and what stays on disk."""
