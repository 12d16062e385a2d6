"""The native capture format, and the images and records that stages pass on.

- `schema`: the keys of capture.yaml; `index`: the checked index of a capture; `cameras`: camera files of other tools.
- `paths`: paths and path patterns inside a capture.
- `images`, `gray`, `reduced_images`, `undistortion`, `crops`, `video`: reading, writing and resampling pictures.
- `records`, `shards`, `head_data`: what training and evaluation read, frame by frame and image by image.
"""
