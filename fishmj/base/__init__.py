"""Plumbing that every room uses: errors, files, options, the command line, pages. It knows nothing of fish."""
