"""Where the gap lies: one score test of regions, zones of joints and patches, and its map."""
