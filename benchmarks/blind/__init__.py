"""Blind check: cases of a world of its own, sealed, diagnosed, unsealed, scored."""
