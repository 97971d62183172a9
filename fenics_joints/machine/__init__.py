"""The machine: where compiled forms are kept, whose folders are safe, and signals."""
