"""Light patterns, radiance transfer, lobes and traced visibility."""
