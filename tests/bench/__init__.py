"""What everything costs, beside other libraries in the same run: make bench. Nothing here decides a test."""
