"""A jointed figure made of tubes: `walking` is its motion and its masks, `painted` its images under lights."""
