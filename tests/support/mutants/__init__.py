"""Planted bugs: single changes of the code that the tests have to see."""
