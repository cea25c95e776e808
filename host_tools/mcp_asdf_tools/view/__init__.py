"""A run as a page in a browser: recorded, live, or computed in the page itself."""
