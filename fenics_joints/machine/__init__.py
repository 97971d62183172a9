"""The machine: where compiled forms are kept, and signals."""
