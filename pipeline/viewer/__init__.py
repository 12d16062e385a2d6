"""Page that shows an avatar and relights it in a browser: one file, which needs no network."""
