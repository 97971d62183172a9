"""What a nominal model may lack: effects with parameters and priors, and the library of them."""
