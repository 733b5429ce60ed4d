"""Reference marks: coded dots around the pick area from which each exposure shows the cameras' positions."""
