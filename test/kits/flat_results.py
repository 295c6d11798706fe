# SPDX-License-Identifier: Apache-2.0
"""Flat results as the counter publishes them, and a certificate for servers on this machine."""

import datetime
import ipaddress

from stack_counter.display.result_schema import SCHEMA_VERSION, flat_line

STAMP = "2023-11-14T22:13:20.123456Z"


def flat(count=600, region="", scan_id="scan 7"):
    """A flat result; with a count of None, that of a scan without one."""
    line = {"schema_version": SCHEMA_VERSION, "scan_id": scan_id, "stamp": STAMP,
            "region": region, "part": "nut", "verdict": "none",
            "views": {"received": 8, "used": 6, "skipped": {"no_tf": 2}}, "reasons": ["one_side"]}
    if count is None:
        return flat_line({**line, "count": None, "status": "error", "error": "1 view used"})
    return flat_line({**line, "count": count, "count_interval": [count - 50, count + 50],
                      "gamma": 0.6, "status": "degraded"})


def write_certificate(folder, uri="urn:test"):
    """Writes a certificate of this machine, signed by itself, and its key; returns both paths."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import rsa
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "stack_counter test")])
    now = datetime.datetime.now(datetime.UTC)
    usage = x509.KeyUsage(True, True, True, True, False, True, False, False, False)
    names = [x509.UniformResourceIdentifier(uri), x509.DNSName("localhost"),
             x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]
    certificate = x509.CertificateBuilder(
        name, name, key.public_key(), x509.random_serial_number(), now,
        now + datetime.timedelta(days=1)).add_extension(
        x509.SubjectAlternativeName(names), False).add_extension(
        x509.BasicConstraints(True, 0), True).add_extension(usage, False).add_extension(
        x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]),
        False).sign(key, hashes.SHA256())
    paths = folder / "certificate.pem", folder / "key.pem"
    paths[0].write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    paths[1].write_bytes(key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption()))
    return paths
