"""What the web site is assembled from: Markdown pages, docstrings, schema, demos."""
