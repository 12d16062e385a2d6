"""Which lights were on in which frame: the log of the LEDs held against the brightness of the images."""
