"""Training an avatar: images of a step, losses, the loop, its log, checkpoints, several processes."""
