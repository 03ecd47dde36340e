"""The page on which a diagram is looked at, edited and run; the file on disk is its only store."""
