"""The soundness proof: decomposition into blocks, exploration of each, and their shapes."""
