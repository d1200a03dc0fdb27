"""Everything that runs once per room: measure or simulate a light transport, invert it, pack it.

One file per command (`<verb>_<noun>.py`: parse, call one library function, print); the libraries are the folders.
May import `player` (the file formats live there), never moderngl or glfw. Nothing in `player` imports this.
Read next: transport/, inverse/, solve/.
"""
