"""Media: names and access rights, frames, the reader and the sound. The processes of decoding/ decode them.

May import errors, files/, writing/ and response. Read next: medium.py, video.py, decoding/.
"""
