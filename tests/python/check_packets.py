"""Compares waveforms of points in LAS and LAZ byte by byte with the source recording."""

import struct

import numpy as np

from check_waveforms import LOW_POWER, flat
from checks import numbers

HEADER = 60
FIRST_DESCRIPTOR, LAST_DESCRIPTOR = 100, 354


def check_packets(checks, path, las, table, container):
    header = las.header
    inside = header.start_of_waveform_data_packet_record
    record = path.read_bytes()[inside:] if inside else path.with_suffix(".wdp").read_bytes()
    user, number, length = record[2:18].rstrip(b"\0"), *struct.unpack_from("<HQ", record, 18)
    checks.equal("packets have their record", (user, number), (b"LASF_Spec", 65535))
    checks.that("packets are as long as their record says", length <= len(record) - HEADER and (inside or length == len(record) - HEADER))
    kinds = {vlr.record_id - FIRST_DESCRIPTOR + 1: descriptor(vlr) for vlr in header.vlrs
             if vlr.user_id == "LASF_Spec" and FIRST_DESCRIPTOR <= vlr.record_id <= LAST_DESCRIPTOR}
    checks.equal("the header says where the packets are", header.global_encoding.waveform_data_packets_internal, bool(inside))
    points = las.points.array
    checks.that("every point has a waveform", bool(np.all(points["wavepacket_index"] > 0)))
    checks.that("vectors point up to the sensor", bool(np.all(points["z_t"] > 0)))
    off = list(differing(record, kinds, points, table, container))
    checks.equal("every packet is a waveform of its shot, and the point lies in it", off[:3], [])


def descriptor(vlr):
    """Descriptor: bits, compression, number of samples, interval in ps, gain and offset."""
    return struct.unpack("<BBIIdd", vlr.record_data_bytes())


def differing(record, kinds, points, table, container):
    """Points whose packet is not the low-power block of their shot that contains the point."""
    blocks = flat(container)
    first_block = np.concatenate([[0], np.cumsum(blocks["per_shot"])])
    first_sample = np.concatenate([[0], np.cumsum(blocks["lengths"])])
    rows = np.searchsorted(numbers(container, "shot"), numbers(table, "shot"))
    for number, (point, row) in enumerate(zip(points, rows)):
        bits, compression, n, spacing_ps, *_ = kinds[point["wavepacket_index"]]
        packet = np.frombuffer(record, f"u{bits // 8}", n, int(point["wavepacket_offset"]))
        of_shot = range(first_block[row], first_block[row + 1])
        recorded = [blocks["samples"][first_sample[b]:first_sample[b + 1]] for b in of_shot if blocks["channel"][b] == LOW_POWER]
        same = any(np.array_equal(packet, samples) for samples in recorded)
        held = 0 <= point["return_point_wave_location"] <= n * spacing_ps
        if not (same and held and compression == 0 and packet.nbytes == point["wavepacket_size"]):
            yield number
