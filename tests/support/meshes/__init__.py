"""Meshes: `glb_files` written byte by byte, and `lit_meshes`, plates and balls under lights."""
