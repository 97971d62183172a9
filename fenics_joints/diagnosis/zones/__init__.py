"""How joints are split into zones that can change each by itself; how stiff they are nominally."""
