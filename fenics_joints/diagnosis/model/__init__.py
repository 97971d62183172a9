"""What a diagnosis works on: the nominal model of a case in zones, with a reduced model."""
