"""Dials that trade accuracy for time, one module per group of stages.

`measure_cost` turns them.

A dial judges what a stage writes, whichever package defines the file, so this package stands above all others but the
stages. To add a dial, add a `Dial` to a list; a stage that no dial turns yet also needs a `CostedStage`.
"""
