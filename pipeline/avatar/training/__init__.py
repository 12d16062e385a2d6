"""Training an avatar: a step's images, losses, loop, log, checkpoints, processes."""
