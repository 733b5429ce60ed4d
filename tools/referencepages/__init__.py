"""The generated parts of the manual's reference, each from the code that defines it (`tools/reference`)."""
