"""Evidence for the effects that a capture calls for, measured on its own images and geometry."""
