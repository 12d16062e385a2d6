"""Parts of an avatar's appearance: diffuse, specular, normals, shadows and indirect light, a module each."""
