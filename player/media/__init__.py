"""Media as they come in: names and how far they reach, frames, the reader and the sound; decoding/ runs as processes.

May import errors, files/, writing/ and response. Read next: medium.py, video.py, decoding/.
"""
