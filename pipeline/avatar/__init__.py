"""The relightable avatar: model, losses, training, checkpoints."""
