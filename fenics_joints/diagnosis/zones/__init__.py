"""Joints split into zones that can change independently, and their nominal stiffness."""
