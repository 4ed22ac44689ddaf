"""Pictures of a swim: replay pages, live play in a browser, the demo."""
