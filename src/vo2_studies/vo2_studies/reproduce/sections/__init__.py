"""One module per section of the dissertation, with NUMBER, TITLE and `run(context) -> Section`; found by folder."""
