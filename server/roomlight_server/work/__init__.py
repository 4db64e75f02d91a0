"""Work beside the event loop: thread pools shared by time, decoding processes and the memory shared with them
(`shared_block`), the decoding of frames and objects.
"""
