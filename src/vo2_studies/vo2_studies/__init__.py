"""What proves the libraries: challenge, reproduction, measured studies, demo and benches; no other package imports it."""
