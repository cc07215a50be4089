"""What follows the measurement: fusion, replay, comparison, verdict, reports, and the shell around them."""
