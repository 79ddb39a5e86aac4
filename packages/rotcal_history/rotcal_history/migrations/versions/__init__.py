"""One module for each step; what is released is never changed."""
