"""Effects that a nominal model may lack, with parameters and priors, and their library."""
