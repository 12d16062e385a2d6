"""Pages of export_viewer in a browser, and the avatars in them."""
