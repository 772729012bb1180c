"""CRC and COBS a second time, bit by bit, so that the codec is not compared with itself."""


def crc_ccitt_false(data: bytes) -> int:
    """CRC-16/CCITT-FALSE."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021) & 0xFFFF if crc & 0x8000 else crc << 1
    return crc


def cobs_by_hand(data: bytes) -> bytes:
    """A frame with its delimiter."""
    return b"".join(bytes([len(block) + 1]) + block for block in data.split(b"\0")) + b"\0"
