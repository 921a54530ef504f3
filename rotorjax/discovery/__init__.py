"""Finding what a model lacks: comparison, fit, rivals."""
