"""Changes to a capture, file by file; each says whether it has to be refused."""
