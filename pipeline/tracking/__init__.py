"""Mesh tracking: keypoints, silhouettes and image colours to the posed template of every frame."""
