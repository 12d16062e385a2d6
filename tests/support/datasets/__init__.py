"""Small captures in the layouts of public sets, and the truth that they were made from.

Written from what the sets' own loaders and datasheets say, with OpenCV, Pillow and plain files: nothing here imports
what reads them.
"""
