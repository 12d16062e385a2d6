"""What every other package may use: conventions, errors, files, the command line of a stage, progress, seeds."""
