"""Synchronisation of the LED log with the images, by the brightness that it predicts.

- `subject_proxy`, `brightness`: the brightness of the subject that a log predicts, and how far off that may be.
- `offset_viterbi`: the offset between log and images in every frame.
- `led_faults`: LEDs that are dead or stuck, and frames under another pattern than the logged one.
- `sync`: the verdict of both; `timeline`: its picture.
- `patterns`: the synced tables of frames and lit lights, mended where the check says so, and their test splits.
"""
