"""GLSL sources, one pass per file; installed as the package counterlight.shaders."""
