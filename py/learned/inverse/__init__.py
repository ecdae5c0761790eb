"""A characteristic turned round: inverse and compensator."""
