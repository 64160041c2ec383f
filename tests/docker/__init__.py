"""The image, its neighbours and what stands before it."""
