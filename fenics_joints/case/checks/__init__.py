"""What is wrong with a case across its sections, a line each."""
