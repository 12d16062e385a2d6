"""Light: `seen_lights`, points under lights that some of them see."""
