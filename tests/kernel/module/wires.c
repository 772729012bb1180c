// SPDX-License-Identifier: GPL-2.0 OR MIT
/* An I2C adapter of the real kernel whose wires end in a file: whoever has /dev/wires open plays the chips.
 *
 * Opening makes an adapter, ioctl 0x7701 returns its number, closing pulls it out. A transfer waits for its answer for a
 * second, as an adapter waits for a clock that is held low, and then ends in ETIMEDOUT; a later answer is ignored.
 *   read:  u32 ticket, u32 messages, as often {u16 address, u16 flags, u16 length, u16 0}, bytes of the write messages
 *   write: u32 ticket, s32 result (messages done, or -errno), bytes of the read messages
 * Test equipment: it cannot be unloaded, and trusts whoever may open it. */
#include <linux/i2c.h>
#include <linux/miscdevice.h>
#include <linux/module.h>
#include <linux/mutex.h>
#include <linux/poll.h>
#include <linux/slab.h>
#include <linux/uaccess.h>
#include <linux/workqueue.h>

#define ADAPTER_NUMBER 0x7701

enum stage { IDLE, OFFERED, TAKEN, ANSWERED };

struct wires {
	struct i2c_adapter adapter;
	struct work_struct removal;
	wait_queue_head_t moved;
	struct mutex lock;	/* of all that follows */
	enum stage stage;
	bool unplugged;
	u32 ticket;
	struct i2c_msg *msgs;	/* of the transfer that waits; gone with it */
	int count, result;
};

static void step(struct wires *w, enum stage stage)
{
	w->stage = stage;
	wake_up_all(&w->moved);
}

static int wires_transfer(struct i2c_adapter *adapter, struct i2c_msg *msgs, int count)
{
	struct wires *w = i2c_get_adapdata(adapter);
	int result = -ENODEV;

	mutex_lock(&w->lock);
	if (w->unplugged)
		goto out;
	w->ticket++;
	w->msgs = msgs;
	w->count = count;
	step(w, OFFERED);
	mutex_unlock(&w->lock);

	wait_event_timeout(w->moved, READ_ONCE(w->stage) == ANSWERED || READ_ONCE(w->unplugged), HZ);

	mutex_lock(&w->lock);
	if (w->stage == ANSWERED)
		result = w->result;
	else if (!w->unplugged)
		result = -ETIMEDOUT;
	w->msgs = NULL;
	step(w, IDLE);
out:
	mutex_unlock(&w->lock);
	return result;
}

static u32 wires_functionality(struct i2c_adapter *adapter)
{
	return I2C_FUNC_I2C;
}

static const struct i2c_algorithm wires_algorithm = {
	.master_xfer = wires_transfer,
	.functionality = wires_functionality,
};

/* Waits for every handle of /dev/i2c-N, one of which may belong to the process that pulls the adapter out. */
static void wires_remove(struct work_struct *work)
{
	struct wires *w = container_of(work, struct wires, removal);

	i2c_del_adapter(&w->adapter);
	kfree(w);
}

static int wires_open(struct inode *inode, struct file *file)
{
	struct wires *w = kzalloc(sizeof(*w), GFP_KERNEL);
	int error;

	if (!w)
		return -ENOMEM;
	mutex_init(&w->lock);
	init_waitqueue_head(&w->moved);
	INIT_WORK(&w->removal, wires_remove);
	w->adapter.owner = THIS_MODULE;
	w->adapter.algo = &wires_algorithm;
	strscpy(w->adapter.name, "wires", sizeof(w->adapter.name));
	i2c_set_adapdata(&w->adapter, w);
	error = i2c_add_adapter(&w->adapter);
	if (error) {
		kfree(w);
		return error;
	}
	file->private_data = w;
	return 0;
}

static int wires_release(struct inode *inode, struct file *file)
{
	struct wires *w = file->private_data;

	mutex_lock(&w->lock);
	w->unplugged = true;
	step(w, w->stage);
	mutex_unlock(&w->lock);
	queue_work(system_long_wq, &w->removal);
	return 0;
}

/* Append to the reader's buffer. */
static int give(char __user *to, size_t room, size_t *at, const void *from, size_t size)
{
	if (*at + size > room)
		return -EMSGSIZE;
	if (copy_to_user(to + *at, from, size))
		return -EFAULT;
	*at += size;
	return 0;
}

static ssize_t wires_read(struct file *file, char __user *to, size_t room, loff_t *offset)
{
	struct wires *w = file->private_data;
	size_t at = 0;
	int i, error = -EAGAIN;

	mutex_lock(&w->lock);
	if (w->stage == OFFERED) {
		u32 head[2] = { w->ticket, w->count };

		error = give(to, room, &at, head, sizeof(head));
		for (i = 0; i < w->count && !error; i++) {
			u16 line[4] = { w->msgs[i].addr, w->msgs[i].flags, w->msgs[i].len, 0 };

			error = give(to, room, &at, line, sizeof(line));
		}
		for (i = 0; i < w->count && !error; i++)
			if (!(w->msgs[i].flags & I2C_M_RD))
				error = give(to, room, &at, w->msgs[i].buf, w->msgs[i].len);
		if (!error)
			step(w, TAKEN);
	}
	mutex_unlock(&w->lock);
	return error ? error : (ssize_t)at;
}

static ssize_t wires_write(struct file *file, const char __user *from, size_t size, loff_t *offset)
{
	struct wires *w = file->private_data;
	size_t at = 8;
	u32 head[2];
	int i, error = 0;

	if (size < sizeof(head) || copy_from_user(head, from, sizeof(head)))
		return -EINVAL;
	mutex_lock(&w->lock);
	if (w->stage == TAKEN && head[0] == w->ticket) {
		w->result = (s32)head[1];
		for (i = 0; i < w->count && w->result >= 0 && !error; i++) {
			if (!(w->msgs[i].flags & I2C_M_RD))
				continue;
			if (at + w->msgs[i].len > size || copy_from_user(w->msgs[i].buf, from + at, w->msgs[i].len))
				error = -EINVAL;
			at += w->msgs[i].len;
		}
		if (!error)
			step(w, ANSWERED);
	}
	mutex_unlock(&w->lock);
	return error ? error : (ssize_t)size;
}

static __poll_t wires_poll(struct file *file, poll_table *table)
{
	struct wires *w = file->private_data;

	poll_wait(file, &w->moved, table);
	return READ_ONCE(w->stage) == OFFERED ? EPOLLIN | EPOLLRDNORM : 0;
}

static long wires_ioctl(struct file *file, unsigned int command, unsigned long argument)
{
	struct wires *w = file->private_data;

	return command == ADAPTER_NUMBER ? w->adapter.nr : -ENOTTY;
}

static const struct file_operations wires_files = {
	.owner = THIS_MODULE,
	.open = wires_open,
	.release = wires_release,
	.read = wires_read,
	.write = wires_write,
	.poll = wires_poll,
	.unlocked_ioctl = wires_ioctl,
};

static struct miscdevice wires_device = { .minor = MISC_DYNAMIC_MINOR, .name = "wires", .fops = &wires_files };

static int __init wires_start(void)
{
	return misc_register(&wires_device);
}
module_init(wires_start);

MODULE_DESCRIPTION("I2C adapter whose chips are a user's program");
MODULE_LICENSE("Dual MIT/GPL");
