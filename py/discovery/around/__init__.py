"""Around an FMU: effects before its inputs and after its outputs."""
