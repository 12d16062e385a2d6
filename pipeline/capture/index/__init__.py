"""The checked index of a capture, made with all complaints at once.

- `validation`: from a capture folder to its index, through all others.
- `csv_tables`: typed csv files; `tables`: cameras, frames, lights, patterns, keypoints, patches.
- `template_checks`, `eye_tables`: the template, its keypoints, its eyes and where they look.
- `frame_images`, `image_checks`: the images of the subject, found and decoded once; `inspected_images`: by other jobs.
- `held_out`: the splits, and the images of each.
- `calibration_files`: calibration images, the chart's corners among them.
"""
