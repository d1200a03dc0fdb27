"""The GPU passes against their CPU functions."""
