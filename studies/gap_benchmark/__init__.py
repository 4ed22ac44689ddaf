"""Lab notes of the benchmark of the search, and the worked example of `docs/search/method.md`."""
