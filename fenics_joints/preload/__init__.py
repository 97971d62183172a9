"""Bolts, their preload and the contact that it makes."""
