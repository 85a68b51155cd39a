"""A flight as godwit logs it, read by pyulog: every topic, field by field; and a file cut in the middle of a message.

  pyulog_test.py WRITE_FLIGHT
"""
import os
import subprocess
import sys
import tempfile

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
