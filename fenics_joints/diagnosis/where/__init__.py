"""Where the gap lies: tests of zones and patches, the error in the constitutive relation, maps."""
