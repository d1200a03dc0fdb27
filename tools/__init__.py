"""Programs that run once per room: measure or simulate a light transport, invert it, pack it.

Each command has a file (`<verb>_<noun>.py`: parse, call one library function, print); the folders are the libraries.
May import `player` (the file formats live there), never moderngl or glfw. `player` does not import this package.
Read next: transport/, inverse/, solve/.
"""
