"""The machine: compiled forms, safe folders, memory, signals, names imported late."""
