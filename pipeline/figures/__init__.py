"""Pictures that a person judges results by: one module per picture, `style` for what they share."""
