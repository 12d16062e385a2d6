"""Synchronisation of the LED log with the images, by the brightness that it predicts.

- `subject_proxy`, `brightness`: the brightness of the subject that a log predicts, and how far off that may be.
- `offset_viterbi`: the offset between log and images in every frame.
- `led_faults`: LEDs that are dead or stuck, and frames under another pattern than the logged one.
- `sync`: the verdict of both; `timeline`: its picture.
- `image_means`, `stored_levels`: brightness of the images, and whether they are over- or underexposed.
- `gain_changes`, `log_alternatives`: exposures that change; other surveys and transfer functions that the images might
  bear out; `image_verdicts`: all of these.
- `patterns`: the synced tables of frames and lit lights, mended where the check says so, and their test splits.
"""
