"""A jointed figure made of tubes: its motion and masks (`walking`), its images (`painted`)."""
