"""Joint parameters by bolt, force, thickness and roughness."""
