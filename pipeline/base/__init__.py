"""The package under all others: conventions, errors, files, stage commands, progress, seeds."""
