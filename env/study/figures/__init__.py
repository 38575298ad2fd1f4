"""The study's tables and figures, made from result files alone; see `aeb figures`."""
