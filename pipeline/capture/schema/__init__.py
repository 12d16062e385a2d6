"""The keys of `capture.yaml`: their types, what they mean, and the page that documents them."""
