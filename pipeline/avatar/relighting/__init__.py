"""Films of an avatar: what drives it in each picture, and what lights it."""
