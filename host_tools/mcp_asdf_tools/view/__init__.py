"""A run as a page in a browser, from a recording or as it goes."""
