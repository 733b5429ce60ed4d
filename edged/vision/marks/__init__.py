"""Reference marks: coded dots around the pick area that show where the cameras are in each exposure."""
