"""A flight as godwit logs it, read by pyulog: every topic, field by field; and a file cut in the middle of a message.

  pyulog_test.py WRITE_FLIGHT LAYOUT      LAYOUT: config/plotjuggler.xml, which must name what is there
"""
import os
import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as xml

import numpy as np
import pyulog
import pyulog.info


def topics(log):
    return {d.name: d.data for d in log.data_list}


def main():
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.argv[1], folder], check=True)
        file = os.path.join(folder, '000001.ulg')
        log = pyulog.ULog(file)
        assert not log.file_corruption
        assert log.msg_info_dict['sys_name'] == 'godwit'
        assert log.msg_info_dict['ver_sw'] == '1.2.3'
        assert 'camera.source' in log.msg_info_dict['configuration']
        pyulog.info.show_info(log, False)  # as ulog_info does
        read = topics(log)
        frame, pose, mapper = read['frame'], read['pose'], read['mapper']
        np.testing.assert_array_equal(frame['sequence'], np.arange(30))
        np.testing.assert_array_equal(frame['timestamp'], 1_000_000 + 33_000 * np.arange(30))
        np.testing.assert_array_equal(frame['t_done'] - frame['timestamp'], 5000)
        np.testing.assert_array_equal(frame['features'], 100 + np.arange(30))
        np.testing.assert_allclose(frame['thread_cpu_ms'], 1.5)
        np.testing.assert_allclose(frame['align_ms'], 0.25)
        np.testing.assert_allclose(frame['map_ms'], 0.75)
        assert not frame['pose_ms'].any()
        np.testing.assert_array_equal(frame['tracked'], np.arange(30) >= 10)
        assert list(np.flatnonzero(frame['is_keyframe'])) == [12]
        np.testing.assert_array_equal(pose['sequence'], np.arange(10, 30))
        np.testing.assert_allclose(pose['position[0]'], 0.1 * np.arange(10, 30))
        np.testing.assert_allclose(pose['position[2]'], 2.5)
        np.testing.assert_allclose(pose['q_xyzw[3]'], 1)
        for k in range(21):
            np.testing.assert_allclose(pose[f'covariance[{k}]'], k)
        np.testing.assert_array_equal(pose['reference_id'], 3)
        np.testing.assert_array_equal(pose['t_reference'], 999_000)
        np.testing.assert_allclose(pose['median_depth'], 4.5)
        np.testing.assert_array_equal(pose['metric'], np.arange(10, 30) >= 20)
        np.testing.assert_array_equal(mapper['points'], [1000] * 6)
        np.testing.assert_array_equal(mapper['outliers'], [7] * 6)
        assert len(log.logged_messages) == 1
        said = log.logged_messages[0]
        assert said.timestamp == 1_500_000 and 'TRACKING -> LOST' in said.message, said.message
        assert said.log_level_str() == 'WARNING'

        np.testing.assert_array_equal(frame['state'], np.arange(30) >= 10)
        load, imu, bus = read['load'], read['imu'], read['bus']
        np.testing.assert_array_equal(load['slips'], np.arange(5, 30))
        np.testing.assert_array_equal(load['rung'], 2 * (np.arange(5, 30) >= 15))
        np.testing.assert_array_equal(load['mask_age_ms'], np.where(np.arange(5, 30) >= 20, 120, -1))
        for field, value in (('mapper_backlog', 2), ('readings_waiting', 7), ('slots_free', 9), ('slots_fewest', 4)):
            np.testing.assert_array_equal(load[field], value)
        np.testing.assert_array_equal(imu['timestamp'],
                                      (1_000_000 + 33_000 * np.arange(30)[:, None] + 5000 * np.arange(6)).ravel())
        np.testing.assert_array_equal(imu['gyro_rad_s[2]'], np.repeat(np.arange(30) * 0.125, 6))
        np.testing.assert_array_equal(imu['accel_m_s2[2]'], -9.8125)
        assert list(np.flatnonzero(imu['flags'])) == list(range(18, 24))
        for field, value in (('odometry_sent', 17), ('tx_abandoned', 3), ('sent', 1234), ('bus_off', 1), ('load_percent', 17.5),
                             ('latency_p99_ms', 21.5), ('quality', -1), ('reset_counter', 250), ('bus_state', 3),
                             ('autopilot_alive', 1), ('armed', 0), ('timestamp', 1_600_000)):
            assert list(bus[field]) == [value], field
        order, detection, box = read['order'], read['detection'], read['box']
        np.testing.assert_array_equal(order['number'], 1 + np.arange(30))
        np.testing.assert_array_equal(order['t_capture_ns'], 1_000_000_000 + 33_000_000 * np.arange(30))
        np.testing.assert_array_equal(order['t_capture_ns'] - order['t_source_ns'], 2_000_000)
        np.testing.assert_array_equal(order['t_capture_ns'] - order['t_reading_ns'], 3_000_000)
        np.testing.assert_array_equal(order['t_detection_ns'], np.where(np.arange(30) == 14, 1_400_000_000, 0))
        np.testing.assert_array_equal(order['readings'], 6 * np.arange(30))
        np.testing.assert_array_equal(order['feature_share'], np.where(np.arange(30) >= 15, 0.5, 1))
        np.testing.assert_array_equal(order['room'], 3)
        np.testing.assert_array_equal(order['deltas'], np.arange(30) % 2)
        assert list(detection['t_capture_ns']) == [1_400_000_000] and list(detection['boxes']) == [2]
        np.testing.assert_array_equal(box['t_capture_ns'], 1_400_000_000)
        np.testing.assert_array_equal([box[f'x0_y0_x1_y1[{k}]'] for k in range(4)], [[10, 1], [20, 2], [110.5, 3], [220, 4]])
        assert list(box['score']) == [0.75, 0.5] and list(box['class_id']) == [2, 7]
        assert list(read['end']['frames']) == [30]
        # This machine's own, as they were: a figure or none.
        assert len(read['machine']['temperature_c']) >= 1 and set(read['machine']['throttled']) <= {0, 1}
        assert not read['log']['dropped'].any() and (np.diff(read['log']['written_bytes'].astype(int)) >= 0).all()
        # No topic that is not looked at here.
        assert set(read) == {'frame', 'pose', 'mapper', 'load', 'imu', 'bus', 'order', 'detection', 'box', 'end', 'machine', 'log'}
        assert log.initial_parameters == {'camera.fps': 30.0, 'tracker.gain': 0.25}
        # PlotJuggler calls an array's values NAME.00, NAME.01.
        curves = [c.get('name') for c in xml.parse(sys.argv[2]).iter('curve')]
        assert len(curves) > 20
        known = {(topic, name): max(size, 1) for topic, form in log.message_formats.items() for _, size, name in form.fields}
        for curve in curves:
            name, index = re.fullmatch(r'(.*?)(?:\.(\d\d))?', curve).groups()
            size = known.get(tuple(name.split('/')), 0)
            assert size > int(index or 0) and (size > 1) == bool(index), f'{sys.argv[2]}: {curve} is not in a flight log'

        # The machine died while it was being written.
        with open(file, 'rb') as f:
            whole = f.read()
        cut = os.path.join(folder, 'cut.ulg')
        with open(cut, 'wb') as f:
            f.write(whole[:len(whole) * 2 // 3 + 5])
        part = topics(pyulog.ULog(cut))['frame']['sequence']
        assert 10 < len(part) < 30
        np.testing.assert_array_equal(part, np.arange(len(part)))
    print('pyulog: ok')


if __name__ == '__main__':
    main()
