"""The other end of a MAVLink port of godwit: each gives (address for godwit, send, receive)."""
import os
import select
import socket
import tty


def udp_port():
    """(address for godwit, send, receive); receive gives None where nothing came in 50 ms."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 14777))

    def receive():
        return sock.recv(2048) if select.select([sock], [], [], 0.05)[0] else None
    return "udp:127.0.0.1:14777:14778", lambda data: sock.sendto(data, ("127.0.0.1", 14778)), receive


def serial_port():
    ours, theirs = os.openpty()
    tty.setraw(theirs)

    def receive():
        return os.read(ours, 2048) if select.select([ours], [], [], 0.05)[0] else None
    return "serial:%s:921600" % os.ttyname(theirs), lambda data: os.write(ours, data), receive
