"""Parts of an avatar's appearance: diffuse, specular, normals, shadows, indirect light."""
