"""Films of an avatar: its driving signals and its light, picture by picture."""
