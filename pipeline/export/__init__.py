"""An avatar as files that other programs open: splats, a mesh, cameras and lights."""
