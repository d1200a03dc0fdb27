"""GLSL sources, one pass a file; installed as the package counterlight.shaders."""
