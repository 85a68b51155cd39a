"""What godwitd tells on the bus, decoded as it comes: NodeStatus and ODOMETRY."""
import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'link'))
from emulated_autopilot import OUR_NODE, Sniffer, mavlink, transport  # noqa: E402

OK = OPERATIONAL = 0
STATUS, TUNNEL = 341, 3001


class Told:
    """statuses: (t, well, in words); well: health OK and mode OPERATIONAL, as an autopilot reads it before it arms.
    odometry: (t, time_usec, quality)."""

    def __init__(self, bus):
        self.sniffer = Sniffer(bus)
        self.statuses, self.odometry = [], []
        self.forget_half()

    def forget_half(self):
        """A process that ends in the middle of a transfer or a message leaves half of it."""
        self.manager, self.parser = transport.TransferManager(), mavlink.MAVLink(None)
        self.parser.robust_parsing = True

    def look(self):
        count = len(self.sniffer.frames)
        frames = self.sniffer.frames[:count]
        del self.sniffer.frames[:count]
        for t, can_id, extended, fd, data in frames:
            if not extended or can_id & 0x7F != OUR_NODE:
                continue
            done = self.manager.receive_frame(transport.Frame(can_id, data, t, t, fd))
            if not done:
                continue
            transfer = transport.Transfer()
            transfer.from_frames(done)
            if transfer.service_not_message:
                continue
            if transfer.data_type_id == STATUS:
                status = transfer.payload
                self.statuses.append((t, status.health == OK and status.mode == OPERATIONAL, 'health %d, mode %d, reasons %#x' % (
                    status.health, status.mode, status.vendor_specific_status_code)))
            elif transfer.data_type_id == TUNNEL:
                for m in self.parser.parse_buffer(bytes(transfer.payload.buffer.to_bytes())) or []:
                    if m.get_type() == 'ODOMETRY':
                        self.odometry.append((t, m.time_usec, m.quality))
