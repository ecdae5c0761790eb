"""Linear models: ARX by least squares, and linear state space; both chosen and refined in free run."""
