"""Pictures that a person judges results by: one module per picture, and `style` for all."""
